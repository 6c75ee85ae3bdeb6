"""Batched episodes, each from a contact that the pre-contact policy chose."""
