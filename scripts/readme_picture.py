#!/usr/bin/env python3
"""Makes the README's picture out of those that `palpate demo` draws.

    cargo run --release --features full -- demo --full
    scripts/readme_picture.py palpate-demo docs/demo.svg

The demo's pictures are made for a wide screen; at the width of a README their labels would be too
small. This takes them apart and sets the three views of the field and the torque in two rows.
Needs nothing but Python.
"""

import re
import sys
from pathlib import Path

VIEW_LEFT = 70  # px from the left edge of a view to its title
NORM_WIDTH = 560  # the norm of the torque is the left panel of its picture
LEGEND_HEIGHT = 44
LEGENDS = [(54, 316), (316, 760)]  # the curves' part, and the areas'
GAP = 24

CIRCLE = re.compile(r'<circle cx="(\d+)" cy="(\d+)" r="(\d+)" opacity="1" fill="(#\w+)"[^>]*/>\n')


def opened(path):
    """The inside of an SVG with its circles in short, and its width and height in px."""
    text = path.read_text()
    width, height = re.search(r'width="(\d+)" height="(\d+)"', text).groups()
    inside = text[text.index(">") + 1 : text.rindex("</svg>")]
    inside = re.sub(f"(?:{CIRCLE.pattern})+", lambda run: dots(run[0]), inside)
    inside = inside.replace(' opacity="1"', "")
    return inside, int(width), int(height)


def dots(circles):
    """The same circles, those of a colour as the round ends of one path."""
    paths = {}
    for x, y, radius, colour in CIRCLE.findall(circles):
        paths.setdefault((colour, radius), []).append(f"M{x} {y}h0")
    return "".join(
        f'<path d="{"".join(places)}" stroke="{colour}" stroke-width="{2 * int(radius)}" '
        'stroke-linecap="round" fill="none"/>\n'
        for (colour, radius), places in paths.items()
    )


def place_of(inside, words):
    """Where a text stands, px from the left and the top."""
    found = re.search(r'<text x="(\d+)" y="(\d+)"[^>]*>\s*' + re.escape(words), inside)
    return int(found[1]), int(found[2])


def piece(picture, left, right, top, bottom, at):
    """A part of a picture, set at a place."""
    (x, y), width, height = at, right - left, bottom - top
    return (
        f'<svg x="{x}" y="{y}" width="{width}" height="{height}" '
        f'viewBox="{left} {top} {width} {height}"><use href="#{picture}"/></svg>'
    )


def main():
    folder, target = map(Path, sys.argv[1:])
    field, field_width, field_height = opened(folder / "field.svg")
    torques, _, torques_height = opened(folder / "torques.svg")
    torques = torques[: torques.rindex("<text", 0, torques.index("joint 1 "))]
    names = ("side (along y)", "top (along z)", "K [N/m]")
    side, top, bar = (place_of(field, name)[0] for name in names)
    side, top, bar = side - VIEW_LEFT, top - VIEW_LEFT, bar - 8
    front_height = place_of(field, "y [m]")[1] + 20

    below = field_height  # where the second row begins
    right = max(side, bar - side - NORM_WIDTH) + GAP  # where the torque begins in it
    torque_below = below + front_height - torques_height
    pieces = [
        piece("field", side, field_width, 0, field_height, (0, 0)),
        piece("field", 0, side, 0, front_height, (0, below)),
        piece("torques", 0, NORM_WIDTH, LEGEND_HEIGHT, torques_height,
              (right, torque_below + LEGEND_HEIGHT)),
    ]
    for row, (start, end) in enumerate(LEGENDS):
        at = (right + 56, torque_below + 30 * (row - 1))
        pieces.append(piece("torques", start, end, 0, LEGEND_HEIGHT, at))

    width, height = max(field_width - side, right + NORM_WIDTH), below + front_height
    target.write_text("\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}">',
        f'<defs><g id="field">{field}</g><g id="torques">{torques}</g></defs>',
        '<rect width="100%" height="100%" fill="white"/>',
        *pieces,
        "</svg>\n",
    ]))


if __name__ == "__main__":
    main()
