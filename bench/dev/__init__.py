"""Tools for the maintainers: whether a change leaves every result and every time the same."""
