from typing import Any

ast_nodes: Any
structs: Any
