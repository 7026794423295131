"""How a diagnosis is judged: an oracle that knows the truth, and counts of hits and misses.

Shared by the studies and by the challenge. It knows no actuator, no bench and no diagnosis: rows
of plain data come in, an oracle is given drives, noise and changes of the displacement.
"""
