"""Links over a Zenoh network: streams and datagrams in samples, through whatever routers there are."""
