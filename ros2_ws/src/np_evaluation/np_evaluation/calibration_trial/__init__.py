"""Rendered calibrations with a known answer."""
