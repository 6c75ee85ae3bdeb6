"""From a diagnosis to recovered success: what the gap costs the task, which effect costs how much, and what training on with it brings back."""
