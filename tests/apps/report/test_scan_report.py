"""Reports of scans: the files of a report, its numbers with their errors, and the reasons for missing results."""

import csv
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from small_pictures import draw_reports_roughly

import warpdiff as wd
from warpdiff.apps.report.report_data import Request, collect
from warpdiff.apps.report.report_figures import figures_of
from warpdiff.apps.report.report_numbers import numbers_of
from warpdiff.apps.report.report_page import page_of

FAST = {"sigmas_um": [2.0], "tolerance": 0.2}


class Page(HTMLParser):
    """Texts, links, descriptions of pictures and unclosed tags of an HTML page."""

    VOID = ("meta", "link", "img", "br", "!doctype")

    def __init__(self, text):
        super().__init__()
        self.links, self.open, self.texts, self.alts = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("href", "src")]
        self.alts += [dict(attrs).get("alt")] if tag == "img" else []
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def grooves(rng, shape=(60, 160), pitch_um=0.1):
    x = pitch_um * np.arange(shape[1])
    return wd.HeightField(0.05 * np.cos(2.0 * np.pi * x / 1.6) + rng.normal(0.0, 0.002, shape), pitch_um)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Height field of noisy grooves, and its report with a measured spectrum and a title that contains HTML."""
    folder = tmp_path_factory.mktemp("report")
    measured = folder / "spectrum.csv"
    measured.write_text("wavelength_nm,counts\n" + "".join(f"{nm},{nm}\n" for nm in range(400, 701, 50)))
    field = grooves(np.random.default_rng(1)).levelled()
    with pytest.MonkeyPatch.context() as small:
        draw_reports_roughly(small)
        report = wd.report(field, folder / "new" / "a", compare=measured, title="<b>@DATE@ & co</b>", **FAST)
    return field, report


def test_a_report_has_a_page_numbers_and_tables(made):
    _, report = made
    names = ["report.html", "report.json"]
    names += [f"{name}.csv" for name in ("roughness", "periods", "theory", "orders", "colours", "comparison")]
    assert [path.name for path in report.paths] == names
    assert sorted(path.name for path in report.page.parent.iterdir()) == sorted(names)
    assert json.loads(report.paths[1].read_text(encoding="utf-8")) == report.numbers
    assert report.reasons == {}


def test_the_page_is_complete_in_itself_and_its_texts_are_escaped(made):
    _, report = made
    text = report.page.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert all(link.startswith("data:") for link in page.links)
    # The page has eight pictures: the heights, two ranges of the power spectrum, the orders, the colours,
    # two exposures of the reflectance map, and the comparison with the measured spectrum.
    assert len(page.alts) == 8
    assert all(page.alts)
    assert "@DATE@ & co" in "".join(page.texts)
    assert "<b>@DATE@" not in text
    assert f"warpdiff {wd.__version__}" in text
    assert "Levelled: subtracted a polynomial of degree 1" in text


def test_numbers_are_those_of_the_library(made):
    field, report = made
    periods = report.numbers["periods"]
    assert periods[0]["period_um"] == field.periods()[0].period_um
    roughness = {row["parameter"]: row for row in report.numbers["roughness"]}
    assert roughness["Sq"]["value"] == field.roughness()["Sq"].value
    assert roughness["Sq"]["standard_error"] > 0.0
    assert report.numbers["surface"]["size_um"] == list(field.size_um)
    assert report.numbers["history"] == list(field.history)
    with report.paths[5].open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    angles = wd.order_angles(field, report.numbers["light"]["to_light"], [450.0, 550.0, 650.0])
    first = next(row for row in rows if float(row["wavelength_nm"]) == 550.0 and row["order"] == "1")
    place = int(np.flatnonzero((angles["wavelength_nm"] == 550.0) & (angles["order"] == 1))[0])
    for name in ("view_theta_deg", "standard_error_deg"):
        assert float(first[name]) == pytest.approx(angles[name][place], rel=1e-9)


def test_efficiencies_of_periods_sum_the_orders_around_them(made):
    # The grooves are a cosine of ten whole periods with little noise. The efficiencies are therefore nearly those of a
    # single period without noise.
    _, report = made
    light = report.numbers["light"]["to_light"]
    orders = {row["order"]: row["efficiency"] for row in report.numbers["orders"] if row["wavelength_nm"] == 550.0}
    exact = wd.order_efficiencies(wd.gratings.sinusoidal(1.6, 0.1), light, 550.0)
    for order in (-1, 0, 1, 2):
        assert orders[order] == pytest.approx(float(exact[0, order][0]), rel=0.05)
    assert sum(orders.values()) < 0.1


def test_every_number_on_the_page_has_an_error_or_a_reason(made):
    _, report = made
    text = report.page.read_text(encoding="utf-8")
    cells = re.findall(r'<td class="number"[^>]*>([^<]*)</td>', text)
    names = ("Sa", "Sq", "Sdq", "Sdr", "Sal")
    for name in names:
        value = re.search(rf"<tr><td[^>]*>{name}</td><td[^>]*>[^<]*</td><td class=\"number\"[^>]*>([^<]*)</td>", text)[
            1
        ]
        assert "±" in value, name
    assert sum("±" in cell or "exact" in cell for cell in cells) > 30
    assert "have no error" in text


def test_orders_below_their_error_are_marked(made):
    _, report = made
    orders, theory = report.numbers["orders"], report.numbers["theory"]
    flat = wd.order_efficiencies(
        wd.HeightField.of_known_scale([[0.0]], 1.0), report.numbers["light"]["to_light"], 450.0
    )
    assert theory[0]["flat_surface_efficiency"] == pytest.approx(float(flat[0, 0][0]))
    for row in orders:
        error = next(line for line in theory if line["wavelength_nm"] == row["wavelength_nm"])["efficiency_error"]
        assert row["model_error"] == pytest.approx(error)
        assert row["is_above_error"] == (row["efficiency"] > error)
        assert abs(row["angle_deg"]) == pytest.approx(row["view_theta_deg"])
    marked = report.page.read_text(encoding="utf-8").count(">not distinguishable from zero<")
    assert marked == sum(not row["is_above_error"] for row in orders) > 0


def test_inputs_settings_and_doubts_are_stated(tmp_path, monkeypatch):
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    x = np.arange(96)
    codes = np.clip(128.0 + 130.0 * np.cos(2.0 * np.pi * x / 2.6) + np.zeros((24, 1)), 0.0, 255.0)
    path = tmp_path / "scan.npy"
    np.save(path, codes.astype(np.uint8))
    field = wd.HeightField.load(path, pitch_um=0.1, height_range_um=0.2).levelled()
    data = collect(request(field, settings={"tolerance": 0.2, "material": wd.Material.metal("Au")}), lambda _: None)
    numbers = numbers_of(data, "title")
    source = numbers["surface"]["source"]
    assert source["stated_by_user"] == {"pitch_um": "0.1", "height_range_um": "0.2"}
    assert source["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert source["clipped_share"] == pytest.approx(np.mean((codes < 1.0) | (codes == 255.0)))
    for doubt in ("may be clipped", "0.26 µm has fewer than 3 samples"):
        assert any(doubt in text for text in numbers["warnings"]), doubt
    assert numbers["settings"]["material"] == "gold"
    assert numbers["settings"]["coherence"] == "averaged window with σ = 2 µm"
    text = page_of(data, numbers, [], [])
    assert source["sha256"] in text
    assert "stated by the user" in text
    assert "gold, unpolarised light" in text
    assert "may be an artefact of sampling" in text


def test_a_measured_spectrum_is_compared_by_a_factor(made):
    _, report = made
    fit = report.numbers["fit"]
    assert fit["computed"] == "relative reflectance in the mirror direction"
    assert fit["scale_standard_error"] > 0.0
    assert str(report).splitlines()[0] == "<b>@DATE@ & co</b>"


def request(field, **changes):
    values = {"to_light": None, "to_view": None, "wavelengths_nm": np.array([550.0]), "sigmas_um": (2.0,)}
    values |= {"illuminant": "D65", "measured": None, "settings": {"tolerance": 0.2}} | changes
    return Request(field, **values)


def test_results_that_cannot_be_found_have_a_reason_on_the_page(monkeypatch):
    def refuse(*_, **__):
        raise MemoryError("the evaluation requires more memory than is free")

    for name in ("reflectance", "reflectance_map", "order_efficiencies"):
        monkeypatch.setattr(f"warpdiff.apps.report.report_data.{name}", refuse)
    data = collect(request(wd.HeightField([[0.0, 0.1, 0.05, 0.2]] * 4, 0.1)), lambda _: None)
    assert {"periods", "orders", "colours", "map"} <= set(data.reasons)
    text = page_of(data, numbers_of(data, "title"), [], [])
    for name in ("Orders", "Colours", "The map"):
        assert f"{name} w" in text
    assert text.count("requires more memory than is free") == 3


def test_a_picture_that_cannot_be_drawn_has_a_reason(monkeypatch):
    def refuse(*_, **__):
        raise ValueError("the aspect is extreme")

    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    data = collect(request(wd.HeightField([[0.0, 0.1, 0.05, 0.2]] * 4, 0.1)), lambda _: None)
    monkeypatch.setattr("warpdiff.plot.height_map", refuse)
    figures = figures_of(data)
    assert "surface" not in [figure.name for figure in figures]
    assert data.reasons["picture of surface"] == "the aspect is extreme"
    text = page_of(data, numbers_of(data, "title"), figures, [])
    assert "The picture cannot be drawn:</b> the aspect is extreme" in text


def test_the_coherence_of_a_plan_is_stated(monkeypatch):
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    field = wd.gratings.sinusoidal(2.0, 0.1)
    plan = wd.plan(field, coherence=wd.Coherence(sigma_um=3.0), tolerance=0.2)
    data = collect(request(field, settings={"plan": plan}), lambda _: None)
    assert numbers_of(data, "title")["settings"]["coherence"] == str(plan.coherence)
    (figure,) = (figure for figure in figures_of(data) if figure.name == "map")
    assert f"({plan.coherence})" in figure.caption


@pytest.mark.parametrize(("size_um", "expected"), [(8.0, (2.0,)), (30.0, (5.0, 7.5))])
def test_windows_of_scans_end_at_their_edges(size_um, expected, rng, monkeypatch):
    """By default, no coherence window is wider than a quarter of a scan. The map has the middle window."""
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    field = grooves(rng, (20, round(size_um / 0.1)))
    field = wd.HeightField(np.repeat(field.heights_um, round(size_um / 2.0), axis=0), 0.1)
    data = collect(request(field, sigmas_um=()), lambda _: None)
    assert data.request.sigmas_um == pytest.approx(expected)
    assert tuple(data.colours) == data.request.sigmas_um
    assert data.request.settings["coherence"] == wd.Coherence(sigma_um=data.request.sigmas_um[len(expected) // 2])
    cell = collect(request(wd.gratings.blazed(2.0, 0.2), sigmas_um=()), lambda _: None)
    assert cell.request.sigmas_um == (5.0, 16.25, 50.0)
    # A profile has one row. Its windows are limited by its length alone.
    profile = wd.HeightField(0.05 * np.sin(np.pi * 0.1 * np.arange(1000))[None, :], 0.1)
    assert collect(request(profile, sigmas_um=()), lambda _: None).request.sigmas_um == (5.0, 16.25, 25.0)


def test_warnings_are_collected_on_the_page(rng, monkeypatch):
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    x = 0.1 * np.arange(60) + np.zeros((40, 1))
    tilted = wd.HeightField.of_known_scale(0.2 * x + 0.005 * rng.normal(size=x.shape), 0.1)
    data = collect(request(tilted), lambda _: None)
    assert any("is not levelled" in warning for warning in data.warnings)
    assert len(set(data.warnings)) == len(data.warnings)


def test_the_light_is_in_the_plane_of_the_strongest_wave(rng, monkeypatch):
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    field = grooves(rng).rotated()
    data = collect(request(field), lambda _: None)
    assert data.azimuth_deg == pytest.approx(90.0, abs=0.2)
    assert data.to_light[1] == pytest.approx(0.5, abs=1e-6)
    assert data.is_cell is False
    assert set(data.orders["order"].tolist()) >= {-1.0, 0.0, 1.0}


def test_a_single_period_counts_as_a_grating_and_its_plane_is_kept(monkeypatch):
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    data = collect(request(wd.gratings.blazed(2.0, 0.2)), lambda _: None)
    assert data.is_cell
    assert data.roughness.order == 0
    assert data.roughness["Sq"].value > 0.05
    assert data.orders["m_x"].tolist() == list(range(-1, 6))


def test_a_wide_scan_has_the_orders_of_its_middle(monkeypatch):
    monkeypatch.setattr("warpdiff.apps.report.report_data._MAP_PIXELS", 8)
    monkeypatch.setattr("warpdiff.apps.report.report_data._MOST_PATCH_ORDERS", 2500.0)
    x = 0.2 * np.arange(200)
    data = collect(
        request(wd.HeightField(0.05 * np.cos(2.0 * np.pi * x / 2.0) + np.zeros((50, 1)), 0.2)), lambda _: None
    )
    # The limit of 2,500 diffraction orders is 50 along each axis. At 550 nm, a side of 13.75 µm has 50 orders, so that
    # the field of 10 µm × 40 µm is cropped along x only.
    assert data.patch_um == pytest.approx((10.0, 13.8), abs=0.2)
    exact = wd.order_efficiencies(wd.gratings.sinusoidal(2.0, 0.1), data.to_light, 550.0)
    table = data.orders.columns
    for order in (0, 1):
        value = float(table["efficiency"][table["order"] == order][0])
        assert value == pytest.approx(float(exact[0, order][0]), rel=0.1)


def test_arguments_are_checked_before_anything_is_computed(tmp_path, rng):
    field = grooves(rng)
    for arguments, message in (
        ({"to_light": (0, 0, -1)}, "to_light must be above the horizon"),
        ({"sigmas_um": []}, "sigmas_um must be 1 to 6 numbers"),
        ({"wavelengths_nm": np.arange(400, 700, 10)}, "wavelengths_nm must be 1 to 12 wavelengths, got 30"),
        ({"compare": tmp_path / "absent.csv"}, "compare: there is no file"),
        ({"tolerance": 7.0}, "tolerance must be"),
        ({"illuminant": "D99"}, "illuminant"),
        ({"sigma_um": 3.0}, "did you mean 'sigmas_um'"),
    ):
        with pytest.raises((ValueError, TypeError, FileNotFoundError), match=message):
            wd.report(field, tmp_path / "report", **arguments)
    assert not (tmp_path / "report").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="folder"):
        wd.report(field, tmp_path / "file" / "report", **FAST)


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'warpdiff\[plot\]'"):
        wd.report(wd.gratings.bumps(), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flat", "point", "column", "row", "tiny", "gaps", "deep", "oblique", "large"])
def test_fields_without_some_results_still_have_a_page(kind, tmp_path, rng):
    y, x = np.mgrid[:60, :80] * 0.1
    gaps = 0.05 * np.cos(2.0 * np.pi * x / 1.5)
    gaps[rng.random(gaps.shape) < 0.4] = np.nan
    heights = {
        "flat": np.zeros((20, 30)), "point": np.zeros((1, 1)), "tiny": np.array([[0.0, 0.1], [0.1, 0.0]]),
        "column": 0.1 * np.cos(np.arange(200.0) / 5.0)[:, None], "row": 0.1 * np.cos(np.arange(200.0) / 5.0)[None],
        "gaps": gaps, "deep": 3.0 * np.cos(np.pi * x), "oblique": 0.05 * np.cos(2.0 * np.pi * (x + y) / 1.5),
        "large": 0.05 * np.cos(2.0 * np.pi * 0.02 * np.arange(4000.0) / 1.5) + np.zeros((3, 1)),
    }[kind]  # fmt: skip
    report = wd.report(wd.HeightField.of_known_scale(heights, 0.02 if kind == "large" else 0.1), tmp_path, **FAST)
    assert Page(report.page.read_text(encoding="utf-8")).open == []
    json.loads(report.paths[1].read_text(encoding="utf-8"))
    assert set(report.reasons) <= {"periods"}
