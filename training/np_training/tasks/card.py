"""The card: pushed over the table, and turned there. Learned without practice."""

from __future__ import annotations

from np_description.domains import CARD as DOMAIN
from np_training.tasks.config import TaskConfig

CARD = TaskConfig(DOMAIN)
