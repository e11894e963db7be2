"""Messages that Warp prints when it starts. Only its warning about the driver is suppressed."""

import os
import subprocess
import sys

import pytest

CODE = """
import os
from warpdiff.device import devices
os.write(2, b"before\\n")
with devices._without_driver_warning():
    os.write(2, b"a line\\nWarning: Could not find or load the NVIDIA CUDA driver.\\nanother line\\n")
os.write(2, b"after\\n")
devices.resolve_device(None)
"""
CLOSED = "import os; from warpdiff.device import devices; os.close(2); devices.resolve_device(None); print('done')"


@pytest.mark.skipif(os.name != "posix", reason="file descriptors require POSIX")
@pytest.mark.parametrize(
    ("code", "errors", "output"),
    [(CODE, "before\na line\nanother line\nafter\n", ""), (CLOSED, "", "done\n")],
    ids=["open", "closed"],
)
def test_only_warps_warning_about_the_driver_is_suppressed(code, errors, output):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (result.stderr, result.stdout) == (errors, output)
