from nacre.optimise.batch import many as many
from nacre.optimise.relief.run import DesignResult as DesignResult
from nacre.optimise.relief.run import design as design
from nacre.optimise.solutions import Design as Design
from nacre.optimise.solutions import Solution as Solution
