"""The one exception for input that cannot be used."""


class InputError(ValueError):
    """A file, configuration, checkpoint or argument that cannot be used.

    The message is a single line that names the file, line or key and says what
    was expected. The command line prints it as it is and exits with status 2.
    """
