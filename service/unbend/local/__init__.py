"""Local signatures: the geodesic circles around many points of a surface, by which parts are recognised."""
