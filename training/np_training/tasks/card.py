"""The card: pushed over the table, and turned there. Learned without practice."""

from __future__ import annotations

from np_description.domains import CARD as DOMAIN
from np_training.tasks.config import TaskConfig

# Half a turn of the card takes 9 s and more where it does not creep under the finger.
CARD = TaskConfig(DOMAIN, limit=200)
