// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Instance} from "../src/interfaces/IDisputeJudge.sol";
import {Finding} from "../src/interfaces/IJudge.sol";
import {Fault, Ruling, Task, TaskRequest} from "../src/interfaces/ITaskManager.sol";
import {CommitteeJudge} from "../src/judges/CommitteeJudge.sol";
import {DisputeJudge} from "../src/judges/DisputeJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Committee} from "./Committee.sol";

/// @notice Three instances: the committee of five, one of seven, one of nine.
abstract contract Instances is Committee {
    uint32 internal constant CHALLENGE = 10 minutes;
    uint32 internal constant DECISION = 20 minutes;
    uint32 internal constant VERDICT_WINDOW = 4 hours;
    uint96 internal constant STAKE = 10 ether;
    uint96 internal constant APPEAL = 30 ether;
    uint96 internal constant JUDGE_STAKE = 5 ether;
    string internal constant REPORT_URI = "https://store/report.json";

    DisputeJudge internal disputes;
    CommitteeJudge internal second;
    CommitteeJudge internal third;
    uint256[] internal secondKeys;
    uint256[] internal thirdKeys;

    function setUp() public virtual override {
        super.setUp();
        disputes = DisputeJudge(deployed("DisputeJudge", abi.encode(organization, address(auditorJudge))));
        (second, secondKeys) = seated("second", 7, 4);
        (third, thirdKeys) = seated("third", 9, 5);
        setInstances(three());
        vm.prank(admin);
        organization.allowKind(CLEANING, disputes, RULES);
        address[4] memory owners = [alice, robot1, judges[0], stranger];
        for (uint256 i = 0; i < 4; ++i) {
            vm.prank(bob);
            coin.transfer(owners[i], 100 ether);
            vm.prank(owners[i]);
            coin.approve(address(disputes), type(uint256).max);
        }
    }

    function everything() internal view returns (uint256) {
        return coin.balanceOf(alice) + coin.balanceOf(robot1) + coin.balanceOf(judges[0])
            + coin.balanceOf(address(organization)) + coin.balanceOf(address(tasks))
            + coin.balanceOf(address(disputes)) + coin.balanceOf(stranger);
    }

    function three() internal view returns (Instance[] memory all) {
        all = new Instance[](3);
        all[0] = Instance(committee, CHALLENGE, 0, STAKE, 0);
        all[1] = Instance(second, CHALLENGE, DECISION, APPEAL, 0);
        all[2] = Instance(third, 0, DECISION, 0, 0);
    }

    /// @dev The judges of all instances but the last need a stake.
    function threeWithStakes() internal view returns (Instance[] memory all) {
        all = three();
        (all[0].judgeStake, all[1].judgeStake) = (JUDGE_STAKE, JUDGE_STAKE);
    }

    /// @dev Whose ruling is challenged next.
    uint8 internal instance;

    /// @dev From the stranger's money.
    function deposit(CommitteeJudge who, uint8 seat_, uint256 amount) internal {
        vm.prank(stranger);
        disputes.depositStake(who, seat_, amount);
    }

    function setInstances(Instance[] memory instances) internal {
        vm.prank(admin);
        disputes.setInstances(CLEANING, instances);
    }

    function seated(string memory name, uint8 count, uint8 votes)
        internal
        returns (CommitteeJudge made, uint256[] memory keys)
    {
        made = committeeJudge(address(0));
        keys = new uint256[](count);
        for (uint8 i = 0; i < count; ++i) {
            address key;
            (key, keys[i]) = makeAddrAndKey(string.concat(name, vm.toString(i)));
            seatIn(made, key, keys[i], key);
        }
        vm.prank(admin);
        made.setQuorum(CLEANING, votes, count, 0, uint64((1 << count) - 1));
    }

    /// @dev A task of alice's whose proof robot1 has submitted, with time for disputes.
    function waiting() internal returns (TaskId taskId) {
        offer(robot1, 80 ether);
        TaskRequest memory wanted = request(100 ether);
        wanted.verdictWindow = VERDICT_WINDOW;
        vm.prank(alice);
        taskId = tasks.registerTask(wanted);
        submit(taskId);
    }

    function voteOf(TaskId taskId, Ruling ruling) internal view returns (Finding memory) {
        Task memory t = tasks.task(taskId);
        uint96 amount = ruling == Ruling.Accepted ? t.price : 0;
        return Finding(taskId, t.attempt, PROOF, REPORT, RULES, ruling, Fault.Nobody, amount, "because");
    }

    /// @dev The first instance has said so.
    function ruled(Ruling ruling) internal returns (TaskId taskId) {
        taskId = waiting();
        first(taskId, ruling);
    }

    function first(TaskId taskId, Ruling ruling) internal {
        instance = 0;
        Finding memory vote = voteOf(taskId, ruling);
        disputes.postVotes(vote, REPORT_URI, signatures(vote, 3));
    }

    function decide(CommitteeJudge who, uint256[] memory keys, uint256 votes, TaskId taskId, Ruling ruling)
        internal
    {
        Finding memory vote = voteOf(taskId, ruling);
        disputes.postVotes(vote, REPORT_URI, by(who, keys, votes, vote));
    }

    function decideSecond(TaskId taskId, Ruling ruling) internal {
        decide(second, secondKeys, 4, taskId, ruling);
        instance = 1;
    }

    function decideThird(TaskId taskId, Ruling ruling) internal {
        decide(third, thirdKeys, 5, taskId, ruling);
    }

    function challenge(address who, TaskId taskId) internal {
        vm.prank(who);
        disputes.challenge(taskId, 1, instance, "wrong");
    }

    function by(CommitteeJudge who, uint256[] memory keys, uint256 count, Finding memory vote)
        internal
        view
        returns (bytes memory all)
    {
        for (uint256 i = 0; i < count; ++i) {
            (bytes32 r, bytes32 vs) = vm.signCompact(keys[i], who.digestOf(vote));
            all = abi.encodePacked(all, r, vs);
        }
    }
}
