"""Files that others wrote: Parquet, text, MAT files and bags of messages.

A path that the configuration names flows in; columns under their own names flow out, or a `FileError`.
"""
