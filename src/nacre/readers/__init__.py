"""Readers for instrument files and other programs: recognised by content.

`open_file` in `registry` is the entry point: it recognises a format by its content and returns one `Measurement` per
spectrum, map, material or colour list of the file.
"""
