"""Tools for maintainers, which check whether a change of the code affects results or computing times."""
