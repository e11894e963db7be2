"""SECURITY.md: each enforced security boundary names tests that exist, and no reader can execute code of a file."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = sorted(path for folder in ("warpdiff", "kernels") for path in (ROOT / folder).rglob("*.py"))
# Calls that may execute code which a file or a text contains. ``ALLOWED`` has the only exception: workers of Dask
# unpickle data that their own client has sent.
DANGEROUS = {"eval", "exec", "compile", "__import__"}
DANGEROUS |= {"pickle.load", "pickle.loads", "marshal.loads", "yaml.load", "os.system"}
MAY_UNPICKLE = ("np.load", "np.lib.format.read_array")
ALLOWED = {("frames.py", "pickle.loads")}


def dangerous_calls(text):
    """Return the calls in a source text that may execute code of a file, and NumPy readers that may unpickle."""
    result = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            stated = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            is_dangerous = name in DANGEROUS
            is_dangerous |= name in MAY_UNPICKLE and stated.get("allow_pickle", "False") != "False"
            is_dangerous |= stated.get("shell") == "True"
            result += [name] if is_dangerous else []
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            module = getattr(node, "module", None) or node.names[0].name
            # Most XML parsers of Python expand entities. The library may use only ``expat``, and refuses document
            # types.
            result += [module] if module.startswith(("xml.etree", "xml.dom", "xml.sax", "yaml")) else []
    return result


def test_dangerous_calls_are_recognised():
    text = "import yaml\neval('1')\nnp.load(f, allow_pickle=True)\nnp.load(f)\nrun('x', shell=True)\npickle.loads(b)"
    assert dangerous_calls(text) == ["yaml", "eval", "np.load", "run", "pickle.loads"]


def test_no_reader_executes_code_of_a_file():
    assert len(SOURCES) > 200
    calls = {(path.name, call) for path in SOURCES for call in dangerous_calls(path.read_text(encoding="utf-8"))}
    assert calls <= ALLOWED


def test_each_enforced_boundary_names_tests_that_exist():
    page = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    rows = [row for row in page.partition("## Not enforced")[0].splitlines() if row.startswith("| ")][2:]
    assert len(rows) >= 12
    for row in rows:
        tests = re.findall(r"`(tests/[\w/]+\.py)`", row)
        assert tests, row
        for test in tests:
            assert (ROOT / test).is_file(), test


def test_links_of_the_project_files_lead_to_files():
    for name in ("CONTRIBUTING.md", "SECURITY.md", "README.md"):
        for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", (ROOT / name).read_text(encoding="utf-8")):
            assert (ROOT / link).exists(), f"{name}: {link}"
