"""The demonstration: its pictures with and without the data of the repository."""

import functools

import pytest
from conftest import slow
from small_pictures import rough

import warpdiff as wd
from warpdiff import gratings
from warpdiff.apps import demo

# Pictures that are only 18 pixels wide have larger errors than usual, so the warning about errors is ignored.
TINY = pytest.mark.filterwarnings("ignore:.*expected to err by more")


def small_gratings(monkeypatch):
    """Make the height fields of the demonstration small: a sixth of the width of the skin, and few disc tracks."""
    fingers = functools.partial(gratings.fingers, size_um=64.0 / 6.0, pitch_um=0.08)
    monkeypatch.setattr(gratings, "fingers", lambda **_: fingers())
    monkeypatch.setattr(gratings, "disc", rough(gratings.disc, tracks=6, length_um=12.5))


def draw_roughly(monkeypatch, *names):
    """Compute pictures and reflectance maps with a tolerance of 0.3 and a coherence window of 2 µm, to save time."""
    for name in names:
        monkeypatch.setattr(demo, name, rough(getattr(demo, name), tolerance=0.3, coherence=wd.Coherence(sigma_um=2.0)))


@TINY
def test_without_the_data_the_demonstration_draws_synthetic_gratings(tmp_path, monkeypatch):
    empty = tmp_path / "data"
    empty.mkdir()
    # Smaller gratings, a shorter coherence window and a larger tolerance make the demonstration several seconds faster.
    small_gratings(monkeypatch)
    draw_roughly(monkeypatch, "shade", "reflectance_map")
    lines: list[str] = []
    written = demo.run(tmp_path / "pictures", data=empty, scale=0.03, say=lines.append)
    assert len(written) == 4
    assert all(path.is_file() for path in written)
    assert "synthetic gratings only" in lines[0]
    monkeypatch.setenv("WARPDIFF_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="WARPDIFF_DATA"):
        demo.data_folder()


@TINY
@pytest.mark.parametrize(
    ("name", "crop_um"),
    [("fuze_elaphe", 10.0), *(slow(f"{each}_elaphe", 65.0) for each in ("snake", "map", "fuze")),
     slow("snake_elaphe_across", 65.0)],
)  # fmt: skip
def test_with_the_data_the_demonstration_draws_the_scan(name, crop_um, fuze_path, scan_path, monkeypatch):
    assert scan_path.is_file()
    cleaned = demo.cleaned_scan
    small_gratings(monkeypatch)
    draw_roughly(monkeypatch, "shade")
    monkeypatch.setattr(demo, "cleaned_scan", lambda path: cleaned(path).cropped(crop_um))
    (made,) = (each for each in demo.pictures(fuze_path.parent, scale=0.03) if each.name == name)
    assert made.make(None).mask.any()
