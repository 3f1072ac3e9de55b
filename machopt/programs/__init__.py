"""Robot programs by maker: posts that write them and readers that read them back."""
