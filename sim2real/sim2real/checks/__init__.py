"""What must hold before and after the inference: plausible recordings, no lack of fit, effects that do not change with time."""
