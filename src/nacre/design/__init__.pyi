from .run import DesignResult as DesignResult
from .run import design as design
