"""Damaged height-field and mesh files are read, or refused with their path; no other files are opened."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from endurance import SEED, count, seconds_left

if os.name != "posix":
    pytest.skip("memory limits require POSIX", allow_module_level=True)
HERE = Path(__file__).parent


@pytest.mark.parametrize(
    ("kind", "number"),
    # Of the 17 valid height-field files, seven are texts or .x3p files. In the default test command, the tests damage
    # such files about 80 times, in a soak test 100,000 times.
    [pytest.param("scans", count(200, 245_000), marks=pytest.mark.permanent("damaged scans", shares=40)),
     pytest.param("meshes", count(120, 50_000), marks=pytest.mark.permanent("damaged meshes, under 4 GB", shares=20)),
     pytest.param("gltf", count(120, 100_000), marks=pytest.mark.permanent("damaged glTF, under 4 GB", shares=20))],
)  # fmt: skip
def test_damaged_files_are_read_or_refused_by_their_path(kind, number, tries, tmp_path):
    seed = SEED or 24
    arguments = [kind, str(seed), str(number), str(min(seconds_left(), 1e6))]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", HERE.parent / "damaged_bytes.py", *arguments], cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stderr}; see the last file in {tmp_path}; seed {seed}"
    tries.number, wrong = json.loads(done.stdout.splitlines()[-1])
    assert not wrong, f"seed {seed}"
