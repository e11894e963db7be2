"""Applications: command line, viewer, web page, sequences, Mitsuba plug-in. No other package imports this one.

In: command-line arguments, signals.
Out: files, messages, an exit code.
"""
