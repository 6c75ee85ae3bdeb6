"""Commands that come late or not at all, measurements that are old."""
