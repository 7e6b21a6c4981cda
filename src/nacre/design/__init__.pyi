from .run import DesignResult as DesignResult
from .run import design as design
from .wants.answers import Solution as Solution
from .wants.many import many as many
from .wants.run import Design as Design
