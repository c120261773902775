"""The server process: settings, connections, logs, metrics, traces, webhooks and backups."""
