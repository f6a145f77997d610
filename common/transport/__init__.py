"""How processes connect: the bus over Zenoh, endpoints, TLS handshakes and credentials."""
