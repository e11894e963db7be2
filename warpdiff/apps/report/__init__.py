"""Report of a scan: one web page with pictures, and its numbers as JSON and CSV files.

In: a height field, a light, and optionally a measured spectrum or goniometer curve.
Out: the files of the report in one folder. The package ``warpdiff.plot`` draws the pictures.
"""
