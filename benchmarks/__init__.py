"""One script a question; numbers and conclusions in README.md."""
