"""Paint what shows at a place of a splat that another program has trained; no photos are needed.

python examples/existing_splat.py garden.ply 0.2,-0.1,0.4,0.5 wave.jpg garden-painted.ply

The numbers are the middle and the radius of a ball around the object, in the splat's units;
`stylesplat objects` of the imported scene says where things are.
"""

import sys
from typing import Literal

import stylesplat as ss

Up = Literal["x", "-x", "y", "-y", "z", "-z"]


def main(splat: str, ball: str, picture: str, output: str, *, up: Up = "-y") -> None:
    """Write the painted splat: the rows of the file in their order, then the new discs."""
    scene = ss.import_(splat, up=up)  # with 36 views around it
    x, y, z, radius = map(float, ball.split(","))
    scene = ss.select(scene, "object", sphere=(x, y, z, radius))
    painted = ss.stylize(scene, {"object": ss.Style(picture, quality="draft")})
    ss.export(painted, output, overwrite=True)
    print(painted)


if __name__ == "__main__":
    main(*sys.argv[1:])
