"""The data of each page, gathered from what was computed: numbers in SI and words, no markup."""
