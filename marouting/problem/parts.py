"""Connected parts of a graph, as a forest in an array (union-find)."""

from typing import Any

from marouting.kernels import inner


@inner
def root_of(part: Any, vertex: int) -> int:
    """The root of a vertex's part; ways to it get shorter.

    Args:
        part: (vertices,) leads from each vertex towards the root of its part; changed.
        vertex: the vertex.
    """
    while part[vertex] != vertex:
        part[vertex] = part[part[vertex]]
        vertex = part[vertex]
    return vertex
