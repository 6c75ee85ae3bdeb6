"""Recordings as the doctor reads them: bags to logs, logs to samples on one grid."""
