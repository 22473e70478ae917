"""Colours of the two bending energies, one shade a mesh family."""

COLORS = {
    "Isotropic": {"union-jack": "#8fb0ee", "equilateral": "#2b5fc8", "delaunay": "#12306f"},
    "hinges": {"union-jack": "#f2b8b4", "equilateral": "#dd716b", "delaunay": "#a3211b"},
}
