"""Public names of ``warpdiff``, each with the module that defines it. ``__init__.py`` reads its names here."""

from warpdiff import datasets as datasets
from warpdiff.apps.mitsuba.bsdf import register_mitsuba_bsdf as register_mitsuba_bsdf
from warpdiff.apps.sequences.sequence import sequence as sequence
from warpdiff.apps.sequences.shots import Shot as Shot
from warpdiff.apps.sequences.shots import camera_path as camera_path
from warpdiff.apps.sequences.shots import light_sweep as light_sweep
from warpdiff.apps.sequences.shots import turntable as turntable
from warpdiff.apps.web_page.export_html import export_html as export_html
from warpdiff.baked.bake_lobes import bake as bake
from warpdiff.baked.bake_spectrum import bake_spectrum as bake_spectrum
from warpdiff.baked.lobe_table import BakedLobes as BakedLobes
from warpdiff.baked.spectrum_table import BakedSpectrum as BakedSpectrum
from warpdiff.core.wording import ToleranceError as ToleranceError
from warpdiff.core.wording import WarpdiffWarning as WarpdiffWarning
from warpdiff.evaluate.orders import OrderEfficiencies as OrderEfficiencies
from warpdiff.evaluate.orders import order_efficiencies as order_efficiencies
from warpdiff.evaluate.reflectance import brdf as brdf
from warpdiff.evaluate.reflectance import reflectance as reflectance
from warpdiff.evaluate.reflectance import reflectance_map as reflectance_map
from warpdiff.evaluate.reflectance import spectral_reflectance as spectral_reflectance
from warpdiff.heightfield.field import HeightField as HeightField
from warpdiff.heightfield.periods import Period as Period
from warpdiff.image.comparison import Comparison as Comparison
from warpdiff.image.comparison import compare as compare
from warpdiff.image.image import Image as Image
from warpdiff.image.report import Report as Report
from warpdiff.lights.directional import DirectionalLight as DirectionalLight
from warpdiff.lights.environment import Environment as Environment
from warpdiff.lights.point import PointLight as PointLight
from warpdiff.optics.coherence import Coherence as Coherence
from warpdiff.optics.materials import Material as Material
from warpdiff.optics.spectra import Spectrum as Spectrum
from warpdiff.planner.strategy import plan as plan
from warpdiff.render.renderer import Renderer as Renderer
from warpdiff.render.shade import shade as shade
from warpdiff.request.plan import Plan as Plan
from warpdiff.samples import gratings as gratings
from warpdiff.samples import meshes as meshes
from warpdiff.scene.camera import View as View

__version__: str
