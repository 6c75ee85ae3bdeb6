"""The task suite: experiments in which the hand touches table and object, planned one after the other from what is seen and felt."""
