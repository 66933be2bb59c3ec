"""Interface of external flight software: messages, C structures, Protobuf messages."""
