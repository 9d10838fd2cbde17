"""SOG and streamed SOG."""
