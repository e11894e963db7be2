"""Sphinx configuration of the documentation site, which ``make docs`` builds."""

import sys
from importlib import metadata
from pathlib import Path

import warpdiff

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))
# Public modules such as ``warpdiff.gratings`` are only attributes of the package. With these entries Sphinx can import
# them by their public names.
for name in ("adjoint", "gratings", "meshes", "datasets", "plot", "profiles"):
    if hasattr(warpdiff, name):
        sys.modules[f"warpdiff.{name}"] = getattr(warpdiff, name)

project = "warpdiff"
author = "The warpdiff developers"
copyright = "2026, The warpdiff developers"
release = version = metadata.version("warpdiff")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinx_design",
    "sphinx_copybutton",
    "formulas",
    "generated_reference",
]
templates_path = ["templates"]
exclude_patterns = ["_build", "extensions", "templates", "jupyter_execute"]
# sphinx-gallery writes scripts and notebooks for download into the folder of its pages. Sphinx must not read them.
exclude_patterns += [f"gallery/**/*.{suffix}" for suffix in ("ipynb", "py", "md5", "json", "zip")]
nitpicky = True
# Sphinx does not warn about missing references to classes of other packages.
nitpick_ignore_regex = [(r"py:class", r"(?!warpdiff\.).*")]

html_theme = "pydata_sphinx_theme"
html_title = "warpdiff"
html_static_path = ["static"]
html_css_files = ["warpdiff.css"]
html_show_sourcelink = False
html_math_renderer = "mathml"
# Without this value the theme writes an error to the console of the browser.
html_context = {"default_mode": "auto"}
html_theme_options = {
    "show_nav_level": 2, "navigation_with_keys": False, "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
}  # fmt: skip

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
# Sphinx runs a notebook again only if its text has changed.
nb_execution_mode = "cache"
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_merge_streams = True

autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autoclass_content = "both"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False

if (HERE.parent / "examples").is_dir():
    extensions.append("sphinx_gallery.gen_gallery")
    sphinx_gallery_conf = {
        "examples_dirs": "../examples",
        "gallery_dirs": "gallery",
        "filename_pattern": r"plot_",
        "image_scrapers": ("gallery_pictures.saved_pictures", "matplotlib"),
        "subsection_order": [
            f"../examples/{topic}"
            for topic in (
                "first_steps",
                "scans",
                "gratings",
                "plots",
                "lights",
                "materials",
                "coherence",
                "sequences",
                "gradients",
                "comparison",
                "export",
            )
        ]
        # Topics that are not listed come last.
        + ["*"],
        "within_subsection_order": "FileNameSortKey",
        "remove_config_comments": True,
        "show_memory": False,
        # These pages load scripts from the network.
        "write_computation_times": False,
        "download_all_examples": False,
        "abort_on_example_error": True,
    }
