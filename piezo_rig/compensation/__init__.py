"""The drive that makes an actuator follow a target: a model, inverted sample by sample.

    tables      a model as plain arrays
    operations  what each kind of stage does in one step
    machine     the model sample by sample, forwards and backwards
    stepper     the same, from Python
    stages      which stages are inverted, which are left out, and why
    compensate  a target and a rig's limits in, a drive out
"""

from piezo_rig.compensation.compensate import Compensation, Target, compensate
from piezo_rig.compensation.stepper import Bounds, OutOfReach, Stepper

__all__ = ["Bounds", "Compensation", "OutOfReach", "Stepper", "Target", "compensate"]
