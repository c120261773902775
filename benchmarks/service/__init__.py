"""The service: throughput, reliability, contract, storage."""
