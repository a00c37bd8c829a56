// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Finding} from "../../src/interfaces/IJudge.sol";
import {TaskRequest} from "../../src/interfaces/ITaskManager.sol";
import {CommitteeJudge} from "../../src/judges/CommitteeJudge.sol";
import {TaskId} from "../../src/types/TaskId.sol";
import {Committee} from "../Committee.sol";

/// @notice Anybody posts whatever votes it can get hold of, and judges change their keys.
contract VotesInvariants is Committee {
    /// @dev Judges 0 to 4 for nobody, 5 for robot1, 6 for another kind, and whoever changed its key last.
    uint256 private constant SIGNERS = 8;
    uint256 private constant LISTED = 6;
    uint8 private constant PANEL = 4;
    uint32 private constant ROTATION = 10 minutes;

    uint256[SIGNERS] private _secrets;
    uint256 private _fresh = 1;
    CommitteeJudge private _other;
    uint256 private _wronglyCounted;
    uint256 private _wronglyRefused;

    function setUp() public override {
        super.setUp();
        (address ofRobot, uint256 secretOfRobot) = makeAddrAndKey("of robot1");
        (address ofCharges, uint256 secretOfCharges) = makeAddrAndKey("of charges");
        (, uint256 another) = makeAddrAndKey("another");
        for (uint256 i = 0; i < JUDGES; ++i) {
            _secrets[i] = judgeKeys[i];
        }
        (_secrets[5], _secrets[6], _secrets[7]) = (secretOfRobot, secretOfCharges, another);
        seat(ofRobot, secretOfRobot, robot1);
        seat(ofCharges, secretOfCharges, ofCharges);
        setQuorum(VOTES, PANEL, ROTATION, uint64((1 << LISTED) - 1));
        vm.prank(admin);
        committee.setQuorum(CHARGING, 1, 1, 0, 1 << 6);
        _other = committeeJudge(address(0));
        offer(robot1, 1 gwei);
        offer(robot2, 1 gwei);
        bytes4[] memory actions = new bytes4[](2);
        (actions[0], actions[1]) = (this.postVotes.selector, this.changeAnyKey.selector);
        targetSelector(FuzzSelector(address(this), actions));
        targetContract(address(this));
    }

    /// forge-config: default.invariant.runs = 16
    /// @notice Votes count if, and only if, enough different judges of the kind, none of them a party's and all in
    /// the panel, signed what is posted, for this committee and this chain.
    function invariant_exactlyTheVotesOfEnoughJudgesCount() public view {
        assertEq(_wronglyCounted, 0, "counted");
        assertEq(_wronglyRefused, 0, "refused");
    }

    function postVotes(uint256 seed, uint256 number, uint256 alteration, uint256 waited) external {
        vm.prank(alice);
        TaskId taskId =
            tasks.registerTask(TaskRequest(CLEANING, 1 gwei, WINDOW, WINDOW, 1, 0, 0, address(0), "{}"));
        submit(taskId);
        uint256 submitted = block.timestamp;
        skip(bound(waited, 0, WINDOW));
        Finding memory vote = accepting(taskId);
        alteration = bound(alteration, 0, 5); // mostly none
        uint256[] memory signers = new uint256[](bound(number, 1, 5));
        for (uint256 i = 0; i < signers.length; ++i) {
            signers[i] = (seed >> (8 * i)) % SIGNERS;
        }
        bytes memory votes = _signed(vote, signers, alteration);
        bool due = alteration < 3 && _mayJudge(taskId, signers, submitted);
        try committee.postVotes(vote, "report", votes) {
            if (!due) ++_wronglyCounted;
        } catch {
            if (due) ++_wronglyRefused;
            vm.warp(submitted + WINDOW + 1);
            tasks.conclude(taskId);
        }
    }

    function changeAnyKey(uint256 which) external {
        which = bound(which, 0, LISTED - 1);
        uint256 secret = uint256(keccak256(abi.encode("fresh", ++_fresh)));
        address oldKey = vm.addr(_secrets[which]);
        changeKey(oldKey, oldKey, vm.addr(secret), secret);
        (_secrets[7], _secrets[which]) = (_secrets[which], secret);
    }

    /// @dev All that a signature may be of and for, beside what is posted.
    function _signed(Finding memory vote, uint256[] memory signers, uint256 alteration)
        private
        returns (bytes memory all)
    {
        uint256 chain = block.chainid;
        uint8 attempt_ = vote.attempt;
        if (alteration == 3) vote.attempt = attempt_ + 1;
        if (alteration == 4) vm.chainId(chain + 1);
        bytes32 digest = (alteration == 5 ? _other : committee).digestOf(vote);
        vote.attempt = attempt_;
        vm.chainId(chain);
        for (uint256 i = 0; i < signers.length; ++i) {
            (bytes32 r, bytes32 vs) = vm.signCompact(_secrets[signers[i]], digest);
            all = abi.encodePacked(all, r, vs);
        }
    }

    /// @dev The rule in other words than the contract's.
    function _mayJudge(TaskId taskId, uint256[] memory signers, uint256 submitted)
        private
        view
        returns (bool)
    {
        bool robots = services.providerOf(tasks.task(taskId).serviceId) == robot1;
        uint256 panel = PANEL + (block.timestamp - submitted) / ROTATION;
        for (uint256 i = 0; i < signers.length; ++i) {
            uint256 judge = signers[i];
            if (judge >= LISTED || (robots && judge == 5)) return false;
            uint256 place = 0;
            for (uint256 next = (submitted / 1 days) % LISTED; next != judge; next = (next + 1) % LISTED) {
                ++place;
            }
            if (place >= panel) return false;
            for (uint256 k = 0; k < i; ++k) {
                if (signers[k] == judge) return false;
            }
        }
        return signers.length >= VOTES;
    }
}
