"""Applications: command line, viewer, web page, sequences, Mitsuba plug-in. No package imports them.

In: command-line arguments, signals.
Out: files, messages, an exit code.
"""
