"""The package's warning category.

Errors are plain ``ValueError`` and ``TypeError`` (and ``OSError`` from the file system), each naming the
argument, its value and what is accepted.
"""


class WarpdiffWarning(UserWarning):
    """Something was repaired, left out, or cannot be trusted; the message says what, by how much, and the remedy."""
