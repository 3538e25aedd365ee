# coal is compiled and has no annotations.
from typing import Any

def __getattr__(name: str) -> Any: ...
