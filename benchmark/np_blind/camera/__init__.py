"""Stages of the chain by themselves: boxes seen by a camera, and streams of poses whose clocks differ."""
