"""Interface of external flight software: messages in C and Protobuf."""
