"""Recordings: topics, CDR, MCAP, bags, recorder, replay, and the pages of a report. The library half needs no ROS."""
