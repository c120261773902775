"""Alembic's entry point: run migrations on the connection that `migrate_engine` passes."""

from alembic import context

from unbend.library.storage.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,
    transactional_ddl=True,
)
context.run_migrations()
