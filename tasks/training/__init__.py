"""Training: a learned system reads a snapshot or release of the lake and leaves a model.

What is learned, and how, is the learned system's (`tasks.training.systems`). What is here makes rows of it and computes nothing.
"""

from __future__ import annotations

import dataclasses

from schemas.families.learned_systems import LEARNED_SYSTEMS
from schemas.training import LearnedModel, ModelEvaluation, TrainingStep
from tasks.models import identity_json, model_id_of
from tasks.settings import Config, union_of
from tasks.stage import Blobs, Context, Outcome, Stage
from tasks.training.dataset import Dataset
from tasks.training.learned_systems import SYSTEMS
from tasks.training.system import LearnedSystem
from tasks.training.trained import Measure, Trained
