"""The public benchmark: effects hidden in the simulated bench, played, diagnosed and scored.

``hiding`` is what can be hidden, ``protocols`` what is played, ``noises`` what the sensor adds;
``rehearsal`` asks the plant what a case will show, with the effect and without; ``case`` draws a
case from a seed; ``judge`` is the oracle; ``play`` plays it through the drivers; ``files`` are
what other programs get; ``answers`` is what they hand in, and ``score`` what that is worth.
"""
