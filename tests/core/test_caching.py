"""LRU cache: the least recently used value is removed first, and concurrent threads get the same value for one key."""

import threading

from warpdiff.core.caching import LruCache


def test_the_least_recently_used_value_is_removed_first():
    cache = LruCache(2)
    assert [cache.get_or_make(key, lambda key=key: key.upper()) for key in "ab"] == ["A", "B"]
    assert cache.get("a") == "A"
    cache.put("c", "C")
    assert "b" not in cache
    assert (cache.get("a"), cache.get("b"), len(cache)) == ("A", None, 2)
    cache.clear()
    assert len(cache) == 0


def test_bytes_are_limited_except_for_the_last_value():
    cache = LruCache(most_bytes=10.0, bytes_of=len)
    cache.put("a", "four")
    cache.put("b", "six..6")
    assert len(cache) == 2
    cache.put("a", "seven.7")
    assert "b" not in cache
    cache.put("c", "more than ten bytes")
    assert cache.get("c")
    assert len(cache) == 1


def test_a_lookup_does_not_replace_the_stored_key():
    """The cache must keep the key object with which a value was stored.

    A look-up uses an equal object, which the caller may change later. If the cache stored this object, the stored key
    would then change, too.
    """
    cache, first, equal = LruCache(2), Frozen(1), Frozen(1)
    cache.put(first, "value")
    assert cache.get(equal) == "value"
    equal.number = 2
    assert cache.get(Frozen(2)) is None
    assert cache.get(Frozen(1)) == "value"


class Frozen:
    """Mutable object that tests use as the key of a cache. Two such keys are equal if their numbers are equal."""

    def __init__(self, number):
        self.number = number

    def __hash__(self):
        return 0

    def __eq__(self, other):
        return self.number == other.number


def test_threads_that_make_values_for_the_same_key_all_get_the_first_one():
    cache, both = LruCache(4), threading.Barrier(2)
    results = []

    def ask(name):
        def make():
            both.wait(10.0)
            return name

        results.append(cache.get_or_make("key", make))

    threads = [threading.Thread(target=ask, args=(name,)) for name in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results[0] == results[1]
