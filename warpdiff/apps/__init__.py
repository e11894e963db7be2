"""Applications: command line, viewer, web page, sequences, Mitsuba plug-in. No other package imports this one.

In: command-line arguments, signals of the operating system, values of a page's controls.
Out: files, messages, an exit code.
"""
