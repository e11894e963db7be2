"""Measurements of speed and accuracy, and what they are measured against."""

import os

# Threads that spin between calls would take other methods' time.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
