"""Make the stored pictures of the self-test again."""

from clusterviz.self_test import store_pictures

store_pictures()
