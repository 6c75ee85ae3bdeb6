"""Recordings as the diagnosis reads them: bags to logs, logs to samples on one grid."""
