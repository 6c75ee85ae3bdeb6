"""What every node shares: quality of service, message translation, node idiom, low-latency spinning."""
