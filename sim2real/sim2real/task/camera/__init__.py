"""The view stage: which of camera, lens, table, object and detector explains where corners of the resting object are seen."""
