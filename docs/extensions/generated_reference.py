"""Sphinx extension that generates reference pages from the code: command line, options of functions, public names."""

import argparse
import inspect
import re
from pathlib import Path

import warpdiff as wd
from warpdiff.adjoint import variables
from warpdiff.apps import cli
from warpdiff.core.options import REQUIRED, describe
from warpdiff.heightfield.readers import reader_registry
from warpdiff.lights.base import Light
from warpdiff.request import settings

# Classes of settings with the public functions that accept them, from general settings to those of display colours.
SETTINGS = {
    "PlanSettings": "warpdiff.plan",
    "EvaluationSettings": "warpdiff.reflectance, warpdiff.reflectance_map, warpdiff.report",
    "SpectralSettings": "warpdiff.spectral_reflectance, warpdiff.reflectance_spectra, warpdiff.brdf",
    "PictureSettings": "warpdiff.shade, warpdiff.Renderer",
    "SinglePictureSettings": "warpdiff.shade",
    "ColourSettings": "warpdiff.to_srgb, warpdiff.plot.reflectance_map, warpdiff.plot.colour_strip",
    "GamutSettings": "warpdiff.Image.display",
    "DisplaySettings": "warpdiff.Image.save, warpdiff.sequence",
}
LIGHTS = [name for name in wd.__all__ if inspect.isclass(kind := getattr(wd, name)) and issubclass(kind, Light)]
GROUPS = {
    "Surfaces": [
        "HeightField", "Surface", "GratingMap", "hidden_pictures", "Period", "Periods", "Roughness", "gratings",
        "datasets",
    ],
    "Bodies and cameras": ["meshes", "View"],
    "Lights": [*LIGHTS, "Spectrum"],
    "Materials and coherence": ["Material", "Coherence"],
    "Pictures": ["shade", "Renderer", "Image", "Report", "compare", "Comparison"],
    "Reflectance without a picture": [
        "reflectance", "spectral_reflectance", "reflectance_spectra", "ReflectanceSpectra", "brdf", "reflectance_map",
        "order_efficiencies", "OrderEfficiencies", "order_angles", "direction", "rigorous_order_efficiencies",
        "RigorousEfficiencies",
    ],
    "Gradients and fits": ["adjoint", "profiles", "fit", "Fit", "Minimum", "Measured"],
    "Design": ["design", "Target", "Design"],
    "Plots, tables and reports": ["plot", "Table", "to_srgb", "report", "ScanReport"],
    "Plans and errors": ["plan", "Plan", "ToleranceError", "WarpdiffWarning"],
    "Sequences": ["sequence", "Shot", "turntable", "light_sweep", "camera_path"],
    "Export": [
        "export_html", "bake", "BakedLobes", "bake_spectrum", "BakedSpectrum", "register_mitsuba_bsdf",
        "measure_layout",
    ],
}  # fmt: skip


# Names for contributors who extend the library. They are not attributes of the package ``warpdiff``.
EXTENSION_POINTS = ["warpdiff.lights.base.Light", "warpdiff.heightfield.readers.reader_registry.register_reader"]
FORMATS = (
    "Formats that `HeightField.load` reads. Images of other suffixes, and files of Bruker Nanoscope with numbers as "
    "suffixes, are recognised by their content."
)
LITERAL = re.compile(r"(``.*?``)")


def cell(text: object) -> str:
    """Return a text in one line, escaped for a cell of a Markdown table."""
    return " ".join(str(text).replace("|", "\\|").replace("<", "&lt;").split())


def options_page() -> str:
    """Return the page with a table of options for each class of settings."""
    lines, seen = [], set()
    for name, functions in SETTINGS.items():
        lines += [f"## {functions}", ""]
        lines += ["| option | type | range or choices | unit | default | meaning |", 6 * "| --- " + "|"]
        for option in describe(getattr(settings, name)).values():
            allowed = option.range or ", ".join(f"`{choice!r}`" for choice in option.choices)
            default = "required" if option.default is REQUIRED else f"`{option.default!r}`"
            meaning = "as above" if option.name in seen else cell(option.help).replace("``", "`")
            kind = option.kind + (" or None" if option.optional else "")
            lines.append(
                f"| `{option.name}` | {kind} | {cell(allowed)} | {option.unit} | {cell(default)} | {meaning} |"
            )
            seen.add(option.name)
        lines.append("")
    return "\n".join(lines)


def command_line_page() -> str:
    """Return the page with the help texts of all commands, wrapped at 100 characters."""
    lines = []
    for name, command in cli._COMMANDS.items():
        parser = cli._parser([name])
        actions = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
        sub = actions.choices[name]
        sub.formatter_class = lambda prog: argparse.RawDescriptionHelpFormatter(prog, width=100)
        lines += [f"## warpdiff {name}", "", f"{command.what[0].upper()}{command.what[1:]}.", "", "```text"]
        lines += [sub.format_help().rstrip(), "```", ""]
    return "\n".join(lines)


def names_page() -> str:
    """Return the page with the summaries of all public names, grouped by topic."""
    listed = [name for names in GROUPS.values() for name in names]
    missing = sorted(set(wd.__all__) - set(listed))
    if missing:
        raise ValueError(f"docs/extensions/generated_reference.py: GROUPS lacks {', '.join(missing)}")
    lines = []
    for title, names in GROUPS.items():
        lines += [f"## {title}", "", "```{eval-rst}", ".. autosummary::", "   :toctree: generated"]
        lines += ["   :nosignatures:", ""]
        for name in names:
            member = getattr(wd, name, None)
            if inspect.ismodule(member):
                public = getattr(member, "__all__", None) or [
                    key for key, value in vars(member).items()
                    if inspect.isfunction(value) and value.__module__ == member.__name__ and key[0] != "_"
                ]  # fmt: skip
                lines += [f"   warpdiff.{name}.{key}" for key in public]
            elif member is not None:
                lines.append(f"   warpdiff.{name}")
        lines += ["```", ""]
    lines += ["## Extension points", "", "The pages for contributors use these names.", "", "```{eval-rst}"]
    lines += [".. autosummary::", "   :toctree: generated", "   :nosignatures:", ""]
    return "\n".join([*lines, *(f"   {name}" for name in EXTENSION_POINTS), "```", ""])


def lights_page() -> str:
    """Return the table of all lights, with their required arguments and the first sentences of their docstrings."""
    lines = ["| light | what it is |", 2 * "| --- " + "|"]
    for name in LIGHTS:
        parameters = inspect.signature(getattr(wd, name)).parameters.values()
        required = ", ".join(one.name for one in parameters if one.default is one.empty)
        lines.append(f"| `{name}({required})` | {cell(inspect.getdoc(getattr(wd, name)).partition('.')[0])} |")
    return "\n".join([*lines, ""])


def formats_page() -> str:
    """Return the table of file formats of height fields, from the registry of readers."""
    lines = ["| format | suffixes | the file states, and you state | extra |", 4 * "| --- " + "|"]
    for entry in sorted(reader_registry.registered(), key=lambda entry: (bool(entry.extra), entry.title)):
        suffixes = ", ".join(f"`{suffix}`" for suffix in entry.suffixes)
        extra = f"`{entry.extra}`" if entry.extra else ""
        lines.append(f"| {cell(entry.title)} | {suffixes} | {cell(entry.states)} | {extra} |")
    return "\n".join([*lines, ""])


def keep_bars(_app, _what, _name, _object, _options, lines: list[str]) -> None:
    """Escape the bars of formulas such as |w|. reStructuredText would interpret them as substitutions."""
    for k, line in enumerate(lines):
        lines[k] = "".join(part if part[:2] == "``" else part.replace("|", r"\|") for part in LITERAL.split(line))


def write(app, _config) -> None:
    """Write the generated pages before Sphinx reads any page."""
    pages = {
        "api": ("Public names", "Import the package as `import warpdiff as wd`. Each name has a page.", names_page()),
        "options": ("Options of the functions", "Keyword arguments with their ranges and defaults.", options_page()),
        "formats": (
            "Formats of height fields",
            FORMATS,
            formats_page(),
        ),
        "lights": ("Lights", "Pages of the [public names](api.md) list all arguments.", lights_page()),
        "derivatives": (
            "Derivatives",
            "Variables of the functions in `warpdiff.adjoint`, for their argument `wrt`.",
            f"{variables.table()}\n",
        ),
        "command_line": ("Command line", "`warpdiff COMMAND --help` prints these texts.", command_line_page()),
    }
    for name, (title, first, text) in pages.items():
        page = Path(app.srcdir, "reference", f"{name}.md")
        page.parent.mkdir(exist_ok=True)
        content = f"# {title}\n\n{first}\n\n{text}"
        # An unchanged page is not written, so that Sphinx does not read it again.
        if not page.exists() or page.read_text(encoding="utf-8") != content:
            page.write_text(content, encoding="utf-8")


def setup(app) -> dict[str, bool]:
    """Register this extension with Sphinx. The pages are generated before Sphinx searches for pages."""
    app.connect("config-inited", write)
    app.connect("autodoc-process-docstring", keep_bars)
    return {"parallel_read_safe": True}
