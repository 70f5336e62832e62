"""Errors about what a user gave."""


class UserError(ValueError):
    """An argument, a file or a command is not what is accepted.

    Its message names the argument, the value and what is accepted.  The command line prints it in
    one line; any other exception is a defect of ours, or of the user's code, and keeps its traceback.
    """
