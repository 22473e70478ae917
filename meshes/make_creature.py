"""Make the creature's file: ``python meshes/make_creature.py --vertices 13000 --out meshes/creature.ply``."""

from studies.creature import main

if __name__ == "__main__":
    main()
