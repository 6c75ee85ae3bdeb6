"""Training of the policies and the detector; shares every definition with the deployed packages."""
