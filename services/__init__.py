"""The services: separate processes that talk over Eclipse Zenoh, built as cores without I/O inside thin shells."""
