"""The viewer: a page on which body, light and surface are turned by hand, and the server that draws for it.

In: what a page has set, files that a command named.
Out: pictures for pages, finer and finer; files and lines that reproduce them.
"""
