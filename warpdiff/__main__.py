"""``python -m warpdiff``."""

import sys

from warpdiff.cli import main

sys.exit(main())
