"""The data of the HTTP API: models, problem documents, and the OpenAPI document."""
