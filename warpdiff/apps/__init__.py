"""The command line: options, signals, standard streams, the demonstration.

In: arguments, signals.
Out: files, messages, an exit code.
"""
