from nacre.optimise.batch import many as many
from nacre.optimise.solutions import Design as Design
from nacre.optimise.solutions import Solution as Solution
