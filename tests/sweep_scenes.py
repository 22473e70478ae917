"""The scene that the tests of killed sweeps share."""

BEAM = """
[scene.mesh]
shape = "v_beam"
cells = [12, 4]
[scene.material]
stretch = 20.0
shear = 20.0
flexure = 0.05
density = 0.2
[scene.supports]
clamped = "x < 0.1"
[scene.model]
name = "mwts"
[scene.motion]
duration = {duration}
dt = 0.01
damping = [0.1, 0.0]
"""
