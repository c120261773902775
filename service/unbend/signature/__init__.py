"""From a surface to its bending-invariant signature: parameters, pipeline, the signature surface."""
