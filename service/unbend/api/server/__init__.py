"""The server process: settings, connections, logs, metrics, webhooks, and backups."""
