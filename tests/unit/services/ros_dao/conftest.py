from tests.support.nodes import make_node as make_node
from tests.support.nodes import router_port as router_port
