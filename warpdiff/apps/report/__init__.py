"""Report of a scan: one web page with pictures, and its numbers as JSON and CSV files.

In: a height field, a light, and optionally a measured spectrum or goniometer curve.
Out: files in a folder. Pictures are drawn by ``warpdiff.plot``.
"""
