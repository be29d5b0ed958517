import numpy as np

from uav_recon.bench.planner.map_agreement import agreement
from uav_recon.types.maps import FREE, OCCUPIED


def test_a_wall_one_voxel_off_agrees_and_two_do_not() -> None:
    reference = np.full((12, 4, 4), FREE, dtype=np.uint8)
    reference[6] = OCCUPIED
    for off, share in ((0, 1.0), (1, 1.0), (2, 11 / 12)):
        state = np.full_like(reference, FREE)
        state[6 + off] = OCCUPIED
        found = agreement(state, reference)
        # the reference wall is free here, but it has free neighbours in the reference
        np.testing.assert_allclose(found.share, share)
        assert found.occupied_freed == (16 if off else 0)


def test_unknown_space_that_the_reference_knows_is_no_agreement() -> None:
    reference = np.full((5, 5, 5), FREE, dtype=np.uint8)
    assert agreement(np.zeros_like(reference), reference).share == 0.0


def test_only_voxels_occupied_in_the_reference_count_as_freed() -> None:
    walled, open_space = np.full((5, 5, 5), FREE, dtype=np.uint8), np.full((5, 5, 5), FREE, dtype=np.uint8)
    walled[2] = OCCUPIED
    assert agreement(open_space, walled).occupied_freed == 25
    assert agreement(walled, open_space).occupied_freed == 0
