"""The command line, and the viewer's page: options, signals, standard streams, the demonstration, a server.

In: arguments, signals, what a page has set.
Out: files, messages, an exit code, pictures on a page.
May import: core, compute, optics, surface, scene, plans, image, evaluate, render, the public names, bench.
"""
