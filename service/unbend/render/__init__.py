"""Pictures of surfaces and signatures, drawn without a display."""
