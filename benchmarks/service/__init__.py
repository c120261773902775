"""Benchmarks of the service: throughput, reliability, contract, storage."""
