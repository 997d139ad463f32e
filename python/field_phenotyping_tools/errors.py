"""The one exception that programs show to their user."""


class InputError(Exception):
    """Input that cannot be used. The message names the cause and the cure."""
