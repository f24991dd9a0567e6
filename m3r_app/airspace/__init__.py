"""Not alone in the air: claims, neighbours and reserved volumes over MQTT 5. Source: paper III-A, V; R5, R11, X10."""
