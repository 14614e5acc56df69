"""What is wrong with a file."""


class FileError(Exception):
    """A file cannot be read, or does not hold what it should; the message fits on one line and names the file."""
