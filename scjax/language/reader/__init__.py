"""What a prompt asks for, as answers of a network: its numbers, its targets, and the reading made of them."""
