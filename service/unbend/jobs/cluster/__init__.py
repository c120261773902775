"""Jobs of a library that several servers and workers share: tickets in Procrastinate's queue, news by PostgreSQL."""
