"""Links over a Zenoh network: streams and datagrams in samples, through any number of routers."""
