"""The two classes of the package `deepbots` 1.0.0 that exported projects use, for tests where it is absent.

They have its names, order of calls and texts of messages.
"""
