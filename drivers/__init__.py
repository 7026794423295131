"""Instruments of the piezo bench, real and simulated. Knows nothing of the application."""
