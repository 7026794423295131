"""Simulated instruments behind the very transports that the real ones use.

Shares nothing with the models that the application fits: a model tested on
itself proves nothing.
"""
