"""How well a classifier tells drawn layouts from true ones (SCA): 50 % when they are alike, 100 % when each gives itself away.

Two classifiers: one of boxes and their relations, and one of pictures from above, as others measure it.
"""

from tasks.synthesis.metrics.discrimination.folds import FOLDS, shuffled
from tasks.synthesis.metrics.discrimination.pictures import PictureClassifier, picture_accuracy
from tasks.synthesis.metrics.discrimination.relations import Classifier, classifier_accuracy

__all__ = ["FOLDS", "Classifier", "PictureClassifier", "classifier_accuracy", "picture_accuracy", "shuffled"]
