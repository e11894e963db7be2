"""Flags of the command line: tangents, pitches, channels, positional height fields, and misspelt flags."""

import numpy as np
import pytest
import trimesh

import warpdiff as wd
from warpdiff.apps import cli, cli_inputs
from warpdiff.apps.cli_options import given, with_joined_vectors
from warpdiff.core.options import describe
from warpdiff.optics.spectra import colour_science
from warpdiff.request.settings import PictureSettings, SinglePictureSettings

SMALL = ["--tolerance", "0.1", "--sigma-um", "5"]


def run(line, *more):
    """Run a command line, given as a text and as further words that may contain spaces, and return its exit code."""
    return cli.main([*line.split(), *map(str, more)])


def test_a_mesh_without_texture_coordinates_is_rendered_with_directions_by_a_rule(tmp_path, capsys):
    mesh, output = tmp_path / "ball.ply", tmp_path / "ball.exr"
    trimesh.creation.icosphere(subdivisions=2).export(mesh)
    words = ["render", mesh, *["--heightfield", "blazed", "--width", "16", "--height", "9"], *SMALL, "-o", output]
    assert run(*words) == 2
    message = "has neither texture coordinates nor tangents; give --tangents smooth, another rule (x, y, "
    assert message in capsys.readouterr().err
    assert run(*words, "--tangents", "smooth") == 0
    assert wd.Image.load(output).xyz.max() > 0.0


@pytest.mark.parametrize(
    ("words", "tangents"),
    [("smooth", "smooth"), ("around-z", "around-z"), ("1 0 0", (1, 0, 0)), ("-1e-3 -0 -.5", (-1e-3, 0, -0.5))],
)
def test_a_mesh_after_the_words_of_tangents_is_the_mesh(words, tangents):
    for line in (
        "render --tangents {} ball.ply -o a.png --heightfield blazed",
        "sequence -o a ball.ply --heightfield blazed --tangents {}", "export-html a.html --tangents {} ball.ply",
    ):  # fmt: skip
        arguments = with_joined_vectors(line.format(words).split())
        options = cli._parser(arguments).parse_args(arguments)
        assert options.mesh == "ball.ply"
        assert given(options, describe(PictureSettings))["tangents"] == tangents


@pytest.mark.parametrize("place", ["--light -1e-3 0 1 {}", "{} --light -1e-3 0 1", "--width 9 --light -1e-3 0 1 {}"])
def test_a_mesh_after_the_numbers_of_a_light_is_the_mesh(place):
    line = "render " + place.format("ball.ply --light point:position=0x2x1") + " -o a.png --heightfield blazed"
    arguments = with_joined_vectors(line.split())
    options = cli._parser(arguments).parse_args(arguments)
    assert options.mesh == "ball.ply"
    lights = cli_inputs.lights_of(options, wd.View((0, 0, 3), (0, 0, 0)))
    distant, point = sorted(lights, key=lambda light: type(light).__name__)
    assert np.allclose(distant.to_light, np.array([-1e-3, 0.0, 1.0]) / np.hypot(1e-3, 1.0))
    assert point.position == (0.0, 2.0, 1.0)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "expected one argument"), ("1 0", "three numbers X Y Z, got '1 0'"),
        ("1 0 0 0", "three numbers X Y Z, got '1 0 0 0'"), ("1,0,0", "got '1,0,0'"),
        ("smoth", "got 'smoth'; did you mean 'smooth'?"), ("ball.ply", "must be one of x, y, z, around-x, "),
    ],
)  # fmt: skip
def test_tangents_without_a_rule_or_three_numbers_are_refused_in_one_line(words, message, capsys):
    with pytest.raises(SystemExit, match="2"):
        run("render --heightfield blazed", "--tangents", *words.split(), "-o", "a.png")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("warpdiff render: --tangents")
    assert line.endswith(" See warpdiff render --help")
    assert message in line


def test_omitted_options_have_the_defaults_of_the_library():
    for command in (["render", "tube"], ["brdf"]):
        arguments = [*command, "--heightfield", "fingers", "-o", "a.png"]
        options = cli._parser(arguments).parse_args(arguments)
        assert given(options, describe(SinglePictureSettings)) == {}
        assert given(options, describe(wd.Image.save)) == {}


PITCHES = (["0.3", "0.15"], ["0.3x0.15"], ["0.3,0.15"], ["0.3×0.15"])
READING = {
    "render": ["tube", "-o", "a.png"], "sequence": ["tube", "-o", "a"], "brdf": ["-o", "a.png"], "info": [],
    "export-html": ["a.html", "tube"], "view": [],
}  # fmt: skip


@pytest.mark.parametrize("command", READING)
@pytest.mark.parametrize("flag", ["--pitch-um", "--extent-um"])
def test_pixels_need_not_be_square_on_any_command(command, flag):
    name = flag.removeprefix("--").replace("-", "_")
    for words, value in [*((pitch, (0.3, 0.15)) for pitch in PITCHES), (["0.3"], 0.3)]:
        arguments = [command, *READING[command], "--heightfield", "a.npy", flag, *words]
        options = cli._parser(arguments).parse_args(arguments)
        assert given(options, describe(wd.HeightField.load)) == {name: value}
    for words in (["0.3", "0.15", "1"], ["1x2x3"]):
        arguments = [command, *READING[command], "--heightfield", "a.npy", flag, *words]
        options = cli._parser(arguments).parse_args(arguments)
        with pytest.raises(ValueError, match=f"{name} must be one number or two, got 3"):
            given(options, describe(wd.HeightField.load))


@pytest.mark.parametrize(("words", "size"), [
    (["--pitch-um", "0.3", "0.15"], "4.5 × 6 µm"), (["--pitch-um", "0.3x0.15"], "4.5 × 6 µm"),
    (["--extent-um", "6,4.5"], "4.5 × 6 µm"), (["--extent-um", "3", "4.5"], "4.5 × 3 µm"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
def test_info_reports_pixels_that_are_not_square(tmp_path, capsys, words, size):
    # The command ``info`` makes no plan (method, number of wavelengths and so on) for a field with missing samples.
    # This saves a second.
    heights = 0.05 * np.sin(np.arange(600.0)).reshape(20, 30)
    heights[3, 4] = np.nan
    np.save(tmp_path / "a.npy", heights)
    assert run("info", tmp_path / "a.npy", *words) == 0
    out = capsys.readouterr().out
    assert f"size              {size} (x × y)" in out
    assert "orientation       row 0 of the picture in 'a.npy' at y = 0 (rows='down')" in out


@pytest.mark.parametrize("words", [["0.3x"], ["axb"], ["0.3;0.15"]])
def test_a_pitch_that_is_no_number_is_refused(words, capsys):
    with pytest.raises(SystemExit):
        cli.main(["info", "--heightfield", "a.npy", "--pitch-um", *words])
    assert "--pitch-um must be a number, got" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
def test_info_reads_a_text_by_its_unit_and_channel(tmp_path, capsys):
    rows = "\n".join(" ".join("NaN" if i == j else f"{20 * np.sin(i + j):.3f}" for i in range(8)) for j in range(5))
    header = "# Channel: {}\n# Width: 2 µm\n# Height: 1 µm\n"
    (tmp_path / "a.txt").write_text(f"{header.format('A')}{rows}\n{header.format('B')}{rows}\n", encoding="utf-8")
    assert run("info", tmp_path / "a.txt", *["--unit", "nm", "--channel", "B", "--rows", "down"]) == 0
    assert "size              2 × 1 µm (x × y), 8 × 5 samples" in capsys.readouterr().out
    assert run("info", tmp_path / "a.txt") == 2
    assert "--unit must be given" in capsys.readouterr().err
    assert run("info --unit nm --channel C", tmp_path / "a.txt") == 2
    assert "--channel must be one of 'A', 'B'" in capsys.readouterr().err


def test_illuminants_whose_names_contain_a_full_stop_are_no_files(tmp_path, monkeypatch):
    # Each illuminant and light source of colour-science must be accepted by its name, also by a name such as "FL3.1",
    # which looks like the name of a file with a suffix. Any other text with a suffix must be read as the path of a
    # file.
    names = [*colour_science().SDS_ILLUMINANTS, *colour_science().SDS_LIGHT_SOURCES]
    assert sum("." in name for name in names) >= 15
    for name in names:
        assert cli_inputs.illuminant_of(name) == name
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.csv").write_text("380,1\n500,2\n780,1\n")
    assert cli_inputs.illuminant_of("my.csv") == wd.Spectrum.from_csv("my.csv")
    with pytest.raises(FileNotFoundError):
        cli_inputs.illuminant_of("FL3.16")
    arguments = ["render", "tube", "--heightfield", "blazed", "-o", "a.png", "--illuminant", "FL3.1"]
    arguments += ["--light", "0", "0", "1", "--light", "directional:to_light=0x0x1,illuminant=FL3.15"]
    options = cli._parser(arguments).parse_args(with_joined_vectors(arguments))
    lights = cli_inputs.lights_of(options, wd.View((0, 0, 1), (0, 0, 0)))
    assert [light.illuminant for light in lights] == ["FL3.1", "FL3.15"]


def test_a_height_field_is_named_once(capsys):
    for arguments in (["info"], ["info", "blazed", "--heightfield", "fingers"], ["brdf", "-o", "a.png"]):
        with pytest.raises(SystemExit) as stopped:
            cli.main(arguments)
        assert stopped.value.code == 2
        assert "HEIGHTFIELD" in capsys.readouterr().err


def test_unknown_options_have_exit_code_2():
    for arguments in ([], ["paint"], ["info"], ["info", "--heightfield", "blazed", "--colour", "red"]):
        with pytest.raises(SystemExit) as stopped:
            cli.main(arguments)
        assert stopped.value.code == 2


def test_a_message_about_a_misspelt_flag_proposes_the_correct_one(capsys):
    with pytest.raises(SystemExit):
        cli.main(["info", "--heightfield", "blazed", "--tolernce", "0.1"])
    assert capsys.readouterr().err == (
        "warpdiff info: there is no argument '--tolernce'; did you mean '--tolerance'? See warpdiff info --help\n"
    )


def test_help_texts_explain_commands_and_options(capsys):
    for command in ("demo", "render", "brdf", "info", "cache"):
        with pytest.raises(SystemExit) as stopped:
            cli.main([command, "--help"])
        assert stopped.value.code == 0
        assert "example:\n  warpdiff " + command in capsys.readouterr().out
