"""Pictures of surfaces and signatures, and files for viewers."""
