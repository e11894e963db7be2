"""Applications: command line, viewer, web page, sequences, Mitsuba plug-in. No other package imports this one.

In: command-line arguments, signals of the operating system, values of the controls on the viewer's page.
Out: files, messages, an exit code.
"""
