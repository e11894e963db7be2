"""Interactive viewer: a page with a body, lights and a surface, and the server that renders for it.

In: the settings of a page, files named on the command line.
Out: pictures of increasing quality; files and lines of code that reproduce them.
"""
