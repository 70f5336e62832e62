"""Errors about what a user gave."""


class UserError(ValueError):
    """An argument, a file or a command is not what is accepted.

    Its message names the argument, the value and what is accepted.  The command line prints it in
    one line.  Any other exception is a defect, and keeps its traceback.
    """
