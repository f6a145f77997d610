"""Monitoring a run: live state, alarms, the terminal view, the browser view and the audit."""
