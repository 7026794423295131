"""Identification: from recordings to a model, with its uncertainty."""

from piezo_rig.causes import load_model
from piezo_rig.chain import save_model
from piezo_rig.identification.data import Data, prepare
from piezo_rig.identification.identify import Identification, identify
from piezo_rig.identification.scores import Scores

__all__ = [
    "Data",
    "Identification",
    "Scores",
    "identify",
    "load_model",
    "prepare",
    "save_model",
]
