"""Runs the drivers against a run's wire transcript."""
