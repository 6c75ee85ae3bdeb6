"""Finetuning after a diagnosis: the cost of the gap and of each effect in success, and the success that training recovers."""
