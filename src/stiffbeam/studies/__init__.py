"""Studies: each answers a question about a case with a table, a sentence and a picture, see ``base.Study``."""

from .base import STUDIES, Answer, Records, Study, find_study, option, studies, study

__all__ = ["STUDIES", "Answer", "Records", "Study", "find_study", "option", "studies", "study"]
