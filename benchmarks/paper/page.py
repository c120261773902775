"""The paper's tables and figures on other meshes, because the paper's meshes were never published.

Writes docs/paper.md and its pictures. Takes a minute or two.
"""

from __future__ import annotations

from benchmarks.common import ROOT
from benchmarks.paper.bending import SAMPLES as FORM_SAMPLES
from benchmarks.paper.bending import figure_1, figure_2, figure_4
from benchmarks.paper.classes import figure_8, figures_6_and_7
from benchmarks.paper.separation import figure_5
from benchmarks.paper.steps import steps
from benchmarks.paper.tables import (
    DIMENSIONS,
    RANDOM_STARTS,
    SAMPLES,
    agreement,
    collapsed,
    other_readings,
    random_starts,
    sizes,
    table_1,
    table_2,
    tori,
)


def main() -> None:
    page = f"{_opening()}\n\n{_steps()}\n\n{_tables()}\n\n{_figures()}"
    (ROOT / "docs" / "paper.md").write_text(page + "\n")
    print(page)


def _opening() -> str:
    return """\
# The paper's tables and figures

Elad & Kimmel, *On bending invariant signatures for surfaces* (PAMI 2003), have two tables and eight figures (Fig. 3 is
a drawing of the cosine law). Their meshes were never published. This page repeats the rest on other meshes, and says
where the outcomes agree. `python -m benchmarks.paper.page` writes this page and its pictures, and computes every number
of ours.

Stand-ins: a torus, a man and a rabbit from Oded Stein's meshes, the elephant and the camel's head of libigl's tutorial,
SHREC'11 (simplified) and TOSCA for classes, and figures that unbend generates."""


def _steps() -> str:
    return f"""\
## Every step and choice, by name

What the paper does or chooses, and the public name, flag and field that does it. A field of HTTP without a path is one
of `parameters` or of an answer.

{steps()}"""


def _tables() -> str:
    return f"""\
## Tables 1 and 2: stress over dimensions

Stress is eq. 2: the sum of (δ - d)² over all pairs, over the sum of δ². {SAMPLES} farthest point samples (the paper
does not say how many it took). **Ours** in bold, the paper's in brackets.

Table 1, least squares:

{table_1()}

Table 2:

{table_2()}

Where they agree, and where not:

{agreement()}

### Figures that are no targets

**Stresses of 5 to 69 at m = 1.** One axis of classical scaling or FastMap cannot give them by eq. 2. Distances along it
are projections, on the whole shorter than those they stand for, so the stress stays below 1, which is what an axis of
length zero gives. A wrong scale would show at m = 2 as well. Other readings of eq. 2 do not help:
{other_readings()}.

A slip that would give such figures, at m = 1 only: in MATLAB, `sum` adds up the columns of a matrix, but *all* of a row
vector. Distances computed as |x_i|² + |x_j|² - 2 x_i x_j, with the squares taken by `sum(X.^2)` of an m x n matrix, are
right for m from 2 on; at m = 1 both squares become the sum over all n points. Which n would it take to get the paper's
figures from our axes?

{collapsed()}

The size is right with a few dozen to some hundred points. But both methods should ask for the same number on a shape;
they nearly do for the human and the elephant, not for the others. A guess that fits in part, no more.

**0.32 to 0.35 for least squares at m = 1**, nearly the same for four different shapes. On a line a step of SMACOF
depends on nothing but the order of the points, and soon the order stays as it is: the result is the start's. (With all
δ equal, every order gives 1 - 2/3 = 0.333.) The plain iteration from {RANDOM_STARTS} random starts, beside ours, which
starts from classical scaling:

{random_starts()}

The paper allows a random start. Such starts make the shapes more alike, and on most of them the worst come near the
paper's figures: these may tell of the start more than of the surface.

**The rabbit's least squares** stands in both tables, with different figures: 0.044 and 0.081 at m = 2, 0.0029 and
0.0033 at m = 3. They cannot be of one run.

**The torus at m = 2.** No torus that we tried has both of the paper's figures, 0.0714 at m = 2 and 0.0098 at m = 3:

{tori()}

**The number of samples** is not what makes the difference. Least squares at m = 3:

{sizes()}"""


def _figures() -> str:
    figures_6_and_7()
    return f"""\
## Fig. 1: texture mapping by flattening

![A bent sheet and a face, flattened, with a chessboard in the plane and on the surface](pictures/paper-fig1.png)

`flatten` is the signature at m = 2. The sheet is developable, and becomes the rectangle it was bent from. The face, cut
from the camel's head, is not; its squares stay squares but for some stretch.

{figure_1()}

## Fig. 2: two postures of a hand

![Two postures of a hand with a geodesic, and their signatures with a straight line](pictures/paper-fig2.png)

From the tip of the thumb to that of the little finger: the minimal geodesic (`geodesic_path`) on contours of equal
distance from the thumb (`iso_contours`), and the straight line that stands for it in the signature.

{figure_2()}

## Fig. 4: three methods

![Four surfaces and their signatures by FastMap, least squares and classical scaling](pictures/paper-fig4.png)

m = 3, {FORM_SAMPLES} samples; all other vertices are placed by their distances to these (`canonical_form`). Colour is
the geodesic distance from one end, the same in a column. Least squares comes out as a bent copy, the others flatten
what is thin: classical scaling spends the torus' third axis on bending the ring, and has none left for the tube.

{figure_4()}

## Fig. 5: separation over dimensions

![The log ratio over m for two pairs of classes and the median of all pairs](pictures/paper-fig5.png)

Natural logarithm of the squared distance between the means of two classes over the sum of their variances, of moments:
second and absolute third ones along each principal axis, at most {2 * max(DIMENSIONS) + 2} numbers (the paper: "less
than 15"). Five classes of TOSCA, up to six members each, scaled to area 1.

{figure_5()}

Up to three dimensions least squares separates most pairs better, as the paper found. Classical scaling draws near with
every further dimension, and ends above it in many pairs; least squares does best with the fewest. Cat and dog are hard
to tell apart by moments: their ratio is below 0, the spread wider than the distance.

## Figs. 6 and 7: eight classes and their signatures

![Eight kinds of generated shapes in three bendings each](pictures/paper-fig6.png)

*Input: three of six bendings of each shape, all generated by unbend.*

![Their signatures, which look alike within each column](pictures/paper-fig7.png)

*Output: their signatures by least squares, m = 3.*

## Fig. 8: the map of classes

![Maps of the shapes by moments: mixed for the surfaces, apart for the signatures](pictures/paper-fig8.png)

Each point is a shape; the map is the MDS of D_M (section 2.3), the squared distances between vectors of moments:
left those of the surfaces as they stand (`surface_moments`), right those of their signatures (`moments`). Above the
shapes of Fig. 6 in all six bendings, below eight classes of real meshes. How often the nearest other shape is of the
same class, and the mean distance between classes over that within:

{figure_8()}

The maps show what two dimensions can of the vectors; the table is of all. The paper's finding holds: the same simple
moments that mix the surfaces up keep the signatures apart."""


if __name__ == "__main__":
    main()
